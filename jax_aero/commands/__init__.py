"""The commands of `jax-aero`, a module for each; a command with parts also has them in the folder of its subject."""
