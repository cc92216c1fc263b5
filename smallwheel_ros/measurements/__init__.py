"""The one reader of measurements: tables of steady single-wheel rows, with units and checks."""
