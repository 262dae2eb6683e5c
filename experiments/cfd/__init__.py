"""Forces of the air on the robot's links by an open solver: `jax-aero cfd DESIGN`.

posture ──geometry──► triangles ──case, foam──► mesh ──foam──► forces of one wind ──design──► Dataset
"""
