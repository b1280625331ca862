"""The bundled maps: data only. `README.md` names their sources and licenses."""
