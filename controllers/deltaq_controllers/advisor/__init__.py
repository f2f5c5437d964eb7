"""The configuration advisor: ranked configurations that hold the hands at given poses."""
