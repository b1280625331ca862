"""Environments for TorchRL. Read `batched_env.py` first."""
