from .model import (
    Origin as Origin,
    load_modulus as load_modulus,
    load_setup as load_setup,
)
