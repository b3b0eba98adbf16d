"""The paper's chain as plain Python components: camera, face detection, face recognition."""
