"""Aerodynamic forces on the robot's links from an open-source solver: `jax-aero cfd DESIGN`.

posture ──geometry──► triangles ──case, foam──► mesh ──foam──► forces of one wind ──design──► Dataset
"""
