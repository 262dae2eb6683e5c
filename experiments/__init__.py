"""Flights, sweeps and studies by name: each turns a configuration into a folder of results."""

from jax_aero.base.terminal import Refused as Refused
