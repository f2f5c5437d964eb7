"""Getting away from an attacker seconds ahead: courses of the arm are tried on a model, and the best one leads."""
