"""The kernels: compiled functions over plain arrays, one noun a file."""
