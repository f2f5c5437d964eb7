"""The configuration advisor: ranked ways to hold the hands where they shall be."""
