"""An exhaustive explorer of Robot Server and SIM, their own code, over wires and crashes of every kind."""
