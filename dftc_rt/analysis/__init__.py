"""What a log says: metrics, timing, figures, report."""
