"""The console's page: laid out by NiceGUI, brought to life by the modules in `browser/` over the live WebSocket.

Nothing that moves a robot, stops one or tells how it moves goes through NiceGUI: its transport buffers.
"""

from deltaq_services.console.page.build import build

__all__ = ["build"]
