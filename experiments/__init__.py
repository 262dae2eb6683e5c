"""Flights, sweeps and studies by name: each turns a configuration into a folder of results."""

from jax_aero.command import Refused as Refused
