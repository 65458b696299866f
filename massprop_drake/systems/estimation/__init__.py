"""Systems of the estimators."""
