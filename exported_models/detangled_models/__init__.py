"""Exported models: ONNX files with a JSON manifest beside each. Data only."""
