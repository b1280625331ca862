"""The commands of `mapf-pz`, one module each, which `mapf_pz.commands.main` loads."""
