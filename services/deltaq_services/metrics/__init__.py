"""The metrics of a running cell for Prometheus: a client like any other, without a lease."""
