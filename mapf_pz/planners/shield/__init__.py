"""The safety layer, which executes the preferences of any policy without collisions, by PIBT or EPIBT."""
