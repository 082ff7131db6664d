"""Who tunes the filter, how that is learned, and how everyone is compared.

Rooms from the bottom up: `contestants`, `contest`, `learning`, `reproduction`, and the
command line `cli`, which alone imports from all. Everything here may import kfenv's
environments, scenarios, filters and models; none of these imports this.
"""
