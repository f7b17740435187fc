"""The stacked equations, least squares on their triangular factor, and honest covariances."""
