"""Compute aerodynamic forces and couples on the links with OpenFOAM: `jax-aero cfd NAME`.

A design (configs/cfd/NAME.toml) names postures, winds and settings. A posture is meshed once for all of its winds.
Every case is kept as soon as it is computed, so the same command resumes an interrupted run. Finally the result is
written: `dataset.nc` with the accepted cases, in the format of `import-cfd`, `cases.json` with all, and `manifest.json`
with the refused ones and the reasons. Needs OpenFOAM: apt-get install openfoam.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from jax_aero.base.arguments import Parser
from jax_aero.base.keys import parse_assignments
from jax_aero.base.terminal import exit_status
from jax_aero.cfd import compute, foam
from jax_aero.cfd.design import KIND, Design
from jax_aero.results import study


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser(KIND, __doc__)
    study.add_names(parser, KIND, nargs="+")
    study.add_set(parser, study.example_of(KIND))
    study.add_name(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default results/cfd)")
    parser.add_argument("--finish", action="store_true", help="compute nothing; collect the existing cases")
    given = parser.parse_args(arguments)

    def work() -> None:
        study.check_name(given)
        for name in given.names:
            design = Design.read(name, parse_assignments(given.set), given.named)
            folder = compute.folder_of(design, given.out)
            if not given.finish:
                foam.environment()
                compute.compute(design, folder)
            print(compute.collect(design, folder))

    return exit_status(work, interrupted="the same command goes on with the next case")
