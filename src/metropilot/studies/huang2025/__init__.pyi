from .drivers import Eitoe as Eitoe
from .drivers import EitoeOptions as EitoeOptions
