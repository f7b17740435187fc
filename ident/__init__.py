"""What happens after a recording: model, preprocessing, regressors, estimators, validation, report."""
