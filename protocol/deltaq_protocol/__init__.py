"""What crosses a link in deltaq, and the client that a controller imports.

Importing this package loads neither pinocchio nor coal.
"""

from importlib.metadata import version

from deltaq_protocol.client import connect

__version__ = version("deltaq")

__all__ = ["__version__", "connect"]
