"""Results: folders of what a command has computed, how it was made, and how it is read again."""
