"""The bundled maps: data only, made by `mapf-pz maps write`."""
