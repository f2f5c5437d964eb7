"""How deltaq is started and shown: the table of services, the launcher, the `deltaq` command."""
