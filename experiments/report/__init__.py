"""The report's experiment: reproduced, repaired, and as published."""
