"""Safe interval path planning: prioritized planning and large neighborhood search."""
