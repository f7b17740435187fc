"""The methods that the benchmark compares, a module for each origin."""
