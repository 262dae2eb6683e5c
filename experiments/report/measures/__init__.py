"""Figures of single flights and ground experiments that claims are judged by."""
