from planish.core.series import Member as Member
