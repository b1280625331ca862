"""The commands of `mapf-pz`, one a file; `mapf_pz.cli` finds them."""
