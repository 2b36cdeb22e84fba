from .setting import course as course
