from .exploring.page import explore as explore
from .pictures import Pictures as Pictures
from .pictures import Tiles as Tiles
from .pictures import group_pictures as group_pictures
from .server import create_app as create_app
from .session import Session as Session
