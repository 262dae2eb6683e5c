"""Run flights by name: `python -m experiments NAME`. Configuration in, one folder of results out."""


class Refused(Exception):
    """The user asked for something that cannot, or must not, be done; the message says what and why."""
