"""Enhanced PIBT: priority inheritance over sequences of actions."""
