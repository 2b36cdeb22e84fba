from .errors import install as install
from .schemas.requests import DriveIn as DriveIn
from .schemas.requests import request_of as request_of
from .server import make_api as make_api
from .server import make_app as make_app
from .server import serve as serve
from .settings import Settings as Settings
from .settings import data_folder as data_folder
