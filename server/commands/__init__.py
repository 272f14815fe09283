"""Groups of commands of ``pairnavi``, each in a file that is loaded when it is asked for."""
