"""Motion and sensor models, each written once for every backend. Imports no other layer."""
