"""How fast environments step, beside a memory copy and beside others: what `mapf-pz benchmark` measures."""
