"""Training in torch, and export to ONNX. Needs the extra: pip install detangled[train]."""
