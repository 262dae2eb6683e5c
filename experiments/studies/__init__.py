"""Studies: questions beyond single flights, each in a folder of its own, found by the folder's name.

    NAME/study.py     a `Study` (`jax_aero.results.study`), and `main`, the command line of `jax-aero study NAME`
    NAME/figure.py    optional: `FIGURES`, drawn by `jax-aero figures`
    NAME/*.toml       optional: configurations by name, with `schema.json` for editors
    NAME/README.md    what it asks, and what was found: a page of the site, with its pictures beside it

Nothing else names a study, except the table of the paper, which leaves out those whose folders are not there.
"""
