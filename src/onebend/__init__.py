"""onebend: learn how stiff a soft slender object is along its length from one push, then bend it where you want."""

__version__ = "0.1.0"
