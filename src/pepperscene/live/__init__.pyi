from .objects import SceneFruit as SceneFruit
from .objects import SceneList as SceneList
from .objects import SceneOrgan as SceneOrgan
from .scene import LiveScene as LiveScene
from .scene import open_scene as open_scene
