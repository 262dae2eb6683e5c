"""Import a flight of the flight lab: from the page's `run.json` to a result folder with `run.nc` and `manifest.json`.

The configuration is checked and hashed like that of any flight, so that `jax-aero fly` and the viewer accept
the folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments import Refused, flight, manifest, record
from jax_aero import cli, io, result, rust
from jax_aero.command import exit_status
from jax_aero.files import read_json


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = cli.Parser("import-lab", __doc__)
    parser.add_argument("run", type=Path, help="run.json exported by the lab")
    parser.add_argument("--name", default="lab", help="name of the result (default: lab)")
    parser.add_argument("--out", type=Path, default=flight.RESULTS, help="folder that will hold the result folder")
    parser.add_argument("--overwrite", action="store_true", help="replace a result of that name")
    given = parser.parse_args(arguments)

    def work() -> None:
        document = read(given.run, given.out / given.name, overwrite=given.overwrite)
        how = result.ending(document["outcome"], document["lost_time"], document["lost_reason"])
        print(f"{given.out / given.name}: {document['title']}: {how}")

    return exit_status(work)


def read(path: Path, folder: Path, *, overwrite: bool = False) -> dict[str, Any]:
    """Write the result folder of a `run.json`; return its manifest."""
    document = read_json(path)
    try:
        flown = result.from_lab(document)
        config = io.make_paths_absolute(document["config"])
        digest = rust.config_digest(config)
    except KeyError as missing:
        raise Refused(f"{path} is no run of the lab: {missing} is missing") from None
    except (ValueError, TypeError) as reason:
        raise Refused(f"{path} is no run of the lab: {reason}") from None
    if record.find_existing(folder, digest, None, overwrite=overwrite) is None:
        written = {
            **{key: value for key, value in document.items() if key not in ("format", "version", "log", "has_ended")},
            "name": folder.name,
            "config": manifest.make_portable(config),
            "config_digest": digest,
            "overrides": {},
            "seed": dict(manifest.seeds(config)) or None,
            "command": f"flight lab {document['link']}",
        }
        dataset = record.to_dataset(flown, rust.Robot(config["robot"]), title=document["title"], config_digest=digest)
        record.write_run(folder, dataset, written, replace=overwrite)
    manifest_of_folder = record.read_manifest(folder)
    assert manifest_of_folder is not None  # just written, or existing
    return manifest_of_folder
