"""Roll-outs of servo arms: simulations on commands alone, of many parameter sets side by side."""
