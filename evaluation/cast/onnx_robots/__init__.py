"""Robots in ONNX files: strangers' data, played as JAX programs, or by onnxruntime apart."""
