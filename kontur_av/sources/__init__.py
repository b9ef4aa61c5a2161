"""Sources of pictures and sound: files, live pipes, cameras, microphones, scenes."""

from kontur_av.sources.scene import SceneAudio as SceneAudio
from kontur_av.sources.scene import SceneVideo as SceneVideo
from kontur_av.sources.source import BLOCK_NS as BLOCK_NS
from kontur_av.sources.source import BLOCK_SAMPLES as BLOCK_SAMPLES
from kontur_av.sources.source import AudioSceneFactory as AudioSceneFactory
from kontur_av.sources.source import AudioSource as AudioSource
from kontur_av.sources.source import VideoSceneFactory as VideoSceneFactory
from kontur_av.sources.source import VideoSource as VideoSource
from kontur_av.sources.spec import check_spec as check_spec
from kontur_av.sources.spec import open_audio as open_audio
from kontur_av.sources.spec import open_video as open_video
