"""Run flights by name: `python -m experiments NAME`. Configuration in, one folder of results out."""

from jax_aero.command import Refused as Refused
