"""YOLOv3: networks from Darknet configurations, their weights, decoding, and detectors for depth and colour images."""
