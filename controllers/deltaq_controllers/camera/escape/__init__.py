"""Escape from an attacker seconds ahead: courses of the arm are simulated on a model, and the best one leads."""
