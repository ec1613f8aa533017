"""Takes the calls that a Meshcat and its animation get."""

from collections import defaultdict


class ShownCalls:
    """The last call of each path and, of an animation, of each frame."""

    def __init__(self):
        self.poses = {}
        self.properties = {}
        self.frames = defaultdict(dict)
        self.objects = []
        self.camera = None

    def SetTransform(self, *words):  # noqa: N802, Drake's name
        if isinstance(words[0], int):
            frame, path, X = words
            self.frames[path][frame] = X
        else:
            path, X = words
            self.poses[path] = X

    def SetProperty(self, *words):  # noqa: N802
        if isinstance(words[0], int):
            frame, path, name, value = words
            self.frames[path, name][frame] = value
        else:
            path, name, value = words
            self.properties[path, name] = value

    def SetObject(self, path, *_):  # noqa: N802
        self.objects.append(path)

    SetLineSegments = SetObject

    def SetCameraPose(self, *camera):  # noqa: N802
        self.camera = camera
