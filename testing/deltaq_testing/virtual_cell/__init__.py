"""A cell in one process and in virtual time: the very cores of the services, and the emulated controllers."""
