"""Flights, sweeps and studies by name: `python -m experiments NAME` turns a configuration into a folder of results."""

from jax_aero.command import Refused as Refused
