"""The predictive law."""
