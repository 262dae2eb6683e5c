"""The study `engine_choice`."""
