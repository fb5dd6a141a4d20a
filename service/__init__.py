"""Turn frames of radar detections into vehicle tracks, lanes and traffic counts."""

__version__ = "0.1.0"
