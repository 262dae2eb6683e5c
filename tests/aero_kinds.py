"""Every kind of aerodynamic model that has a file in `configs/aero`: tests compare a new one as they stand."""

from jax_aero import rust
from jax_aero.base import places

FILES = {rust.load_aero(name)["model"]: name for name in [*places.names("aero"), "axisymmetric_corrected"]}
"""Name of the file by kind; of the axisymmetric models the one with corrected coefficients."""

OF_LINKS = {kind: name for kind, name in FILES.items() if kind != "network"}
"""Those whose force on a link follows from the air at this link alone, which any robot may have."""
