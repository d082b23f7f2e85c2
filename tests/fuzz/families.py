"""The families of the fuzz, by name: each gives as many inputs as asked for, the same for a seed."""

from fuzz import input_files, options, own_files, python_calls, ranged_files

FAMILIES = {
    "files of radial velocities": input_files.cases,
    "files of our own": own_files.cases,
    "files of several ranges": ranged_files.cases,
    "options of commands": options.cases,
    "calls from Python": python_calls.cases,
}
