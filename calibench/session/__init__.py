"""From a protocol file to a shot list, a run, a map and a report."""
