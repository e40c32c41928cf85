"""Neural networks in ONNX files: the shipped fruit model and optional geometry models."""
