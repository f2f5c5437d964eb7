"""Inspection and maintenance routines: data, a planner of their motions, and one interpreter."""
