"""A camera, face detectors and face recognisers as plain Python components.

    messages            what flows between them: Frame -> Faces -> People
    camera              pictures from a file, a folder or a device
    hog, haar           face detectors: dlib's, OpenCV's
    resnet, lbph        face recognisers: dlib's, OpenCV's; each with its `enrol`
    pixels              messages to arrays and back
    photos              photos of persons to enrol

Nothing here imports uoarm's manager; the modules that need dlib say so when they are imported.
"""
