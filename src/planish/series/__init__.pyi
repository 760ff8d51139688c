from .jobs import Book as Book
from .plan import Plan as Plan
from .plan import Specimen as Specimen
from .plan import read_plan as read_plan
