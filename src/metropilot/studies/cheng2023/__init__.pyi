from .ddpg_pid import DdpgPid as DdpgPid
from .env import TrackingConfig as TrackingConfig
from .env import TrackingTask as TrackingTask
from .fuzzy_pid import FuzzyPid as FuzzyPid
from .neural_pid import NeuralPid as NeuralPid
from .setting import course as course
from .tracking import track_course as track_course
from .tracking import tracking_kpis as tracking_kpis
