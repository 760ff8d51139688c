from planish.core.series import Member as Member
from planish.series.jobs import Book as Book
from planish.series.plan import Plan as Plan
from planish.series.plan import Specimen as Specimen
from planish.series.plan import read_plan as read_plan
