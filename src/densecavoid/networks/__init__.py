"""Networks as files: their cards, ONNX to run, safetensors to train on. Not what a network computes."""
