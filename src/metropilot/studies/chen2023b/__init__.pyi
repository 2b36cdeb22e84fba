from .drivers import FollowPolicyOptions as FollowPolicyOptions
from .drivers import SacPid as SacPid
