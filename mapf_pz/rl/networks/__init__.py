"""Networks: actors and critics, encoders of observations, and communication. Read `actors.py` first."""
