"""Questions asked of the library: studies, and the report on the paper; `tools` are those of the repository."""
