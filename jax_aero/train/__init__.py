"""Training of the network of link forces: plain JAX, single precision.

    Dataset ──samples──► Samples ──fit──► Network ──distil──► a smaller Network;   checkpoint stores interrupted runs

A run is a function of its settings, samples and seed. Random numbers depend on the number of the epoch, so a run that
was interrupted and resumed ends with the same bits as an uninterrupted one.
"""

from jax_aero.train.baselines import baseline_errors
from jax_aero.train.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from jax_aero.train.distil import distil_samples
from jax_aero.train.loop import FitResult, Interrupted, Settings, fit
from jax_aero.train.loss import batch_output, mean_squared_error
from jax_aero.train.samples import Samples, predict_areas, samples_of

__all__ = [
    "Checkpoint",
    "FitResult",
    "Interrupted",
    "Samples",
    "Settings",
    "baseline_errors",
    "batch_output",
    "distil_samples",
    "fit",
    "load_checkpoint",
    "mean_squared_error",
    "predict_areas",
    "samples_of",
    "save_checkpoint",
]
