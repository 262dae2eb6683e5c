"""Data of wind tunnel and CFD: imported, and fitted by the axisymmetric model."""
