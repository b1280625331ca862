"""The editor of instances in the browser: `mapf-pz edit`."""
