"""Order tracking and vibration analysis for reciprocating engines and other rotating machines."""
