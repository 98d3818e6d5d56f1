"""Camera detectors: any ONNX model whose inputs and outputs are understood."""
