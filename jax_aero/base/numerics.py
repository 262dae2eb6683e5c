"""Version of the numbers that the Python packages compute: flights by JAX and MuJoCo, trainings, trims, studies.

It is raised where a stored flight changes: `tests/golden` refuses a change without it. That of the crate is
`rust.NUMERICS`.
"""

NUMERICS = 1
