"""A recording as one HTML page that an operator attaches to a log: `deltaq recording report`."""
