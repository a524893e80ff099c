from .model import (
    Origin as Origin,
    load_instruments as load_instruments,
    load_modulus as load_modulus,
    load_setup as load_setup,
)
