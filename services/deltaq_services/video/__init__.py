"""The live picture of a camera: reads its source, and serves the newest picture as JPEG."""
