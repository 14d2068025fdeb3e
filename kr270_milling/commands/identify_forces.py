def add_arguments(p):
    p.add_argument("cuts")
