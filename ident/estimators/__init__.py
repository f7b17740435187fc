"""The estimators behind `--method`."""
