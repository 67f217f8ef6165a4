"""The shipped settings, as nearly every test takes them: whole, and by the stage that reads them."""

from crankorder.settings import load_settings

SETTINGS = load_settings()
CAMPBELL, IDENTIFY, ORDERS, SHAFT = SETTINGS.campbell, SETTINGS.identify, SETTINGS.orders, SETTINGS.shaft
