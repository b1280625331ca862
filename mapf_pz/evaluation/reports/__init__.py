"""Tables, figures, intervals and published results. Read `report.py` first."""
