"""An exhaustive explorer of Robot Server and SIM, their own code, over faulty links and crashes of every kind."""
