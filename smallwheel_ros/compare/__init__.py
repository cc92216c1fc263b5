"""Models against measurements, side by side."""
