"""Alarms: do the beams of a record agree with each other, and with the noise that they are said to have?"""
