"""The guard of the law: which measurements are used, what replaces the others, and what is known of disturbances."""
