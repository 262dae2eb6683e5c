"""The study `wind_observer`."""
