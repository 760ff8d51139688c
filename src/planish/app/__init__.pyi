from .explore import explore as explore
from .server import create_app as create_app
from .session import Session as Session
