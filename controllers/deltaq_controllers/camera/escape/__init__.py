"""Escape from an attacker seconds ahead: the best of many simulated trajectories leads the arm."""
