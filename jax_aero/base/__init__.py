"""What everything else stands on: locations, files, tables of configurations, results, and the terminal."""
