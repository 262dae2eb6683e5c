"""Run flights by name: `python -m experiments NAME`. Configuration in, one folder of results out."""


class Refused(Exception):
    """A request of the user that cannot, or must not, be carried out; the message states what and why."""
