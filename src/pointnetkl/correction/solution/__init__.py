"""The correction itself: what is believed of navigation, loops closed, judged, and carried to every ping."""
