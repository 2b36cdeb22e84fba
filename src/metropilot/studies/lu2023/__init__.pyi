from .drivers import PidLu2023 as PidLu2023
from .drivers import PidLu2023Options as PidLu2023Options
from .notches import NotchOptions as NotchOptions
from .notches import NotchPlan as NotchPlan
from .notches import notch_plan as notch_plan
