"""Figures of any result."""
