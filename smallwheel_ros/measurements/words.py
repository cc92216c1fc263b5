# SPDX-License-Identifier: Apache-2.0
"""The words that people write above their columns, and what this package calls the quantity.

This is the one place for them: English, German, French, and the symbols of the field. A line more
in `WORDS` makes a word known; a quantity of its own also needs its line in `columns.COLUMNS` (unit
and range) if it has to be checked. Case, accents, hyphens, underscores and blanks do not matter in
words; in symbols (after the bar) case does.
"""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Collection
from typing import NamedTuple

from smallwheel_ros.measurements.columns import CHANNELS

WORDS: dict[str, str] = {
    "load": "normal load, vertical load, axle load per wheel, normal force, vertical force, weight, "
    "Last, Radlast, Normallast, Vertikallast, Auflast, Normalkraft, Vertikalkraft, Aufstandskraft, "
    "Gewichtskraft, Gewicht, Belastung, charge, charge verticale, charge normale, force verticale, "
    "force normale, effort normal, effort vertical, poids | W Fz Fn",
    "diameter": "dia, diam, outer diameter, plate diameter, Plattendurchmesser, Durchmesser, "
    "Raddurchmesser, Reifendurchmesser, "
    "Außendurchmesser, diamètre, "
    "diamètre extérieur | D Ø",
    "radius": "Radradius, Halbmesser, rayon | r",
    "width": "plate width, Plattenbreite, Breite, Radbreite, Reifenbreite, largeur | b B",
    "sinkage": "sinkage depth, plate sinkage, settlement, Setzung, tassement, "
    "Einsinkung, Einsinktiefe, Einsenkung, Einsenktiefe, enfoncement, "
    "profondeur d'enfoncement | z",
    "resistance": "motion resistance, rolling resistance, Fahrwiderstand, Rollwiderstand, "
    "Bewegungswiderstand, Widerstand, résistance, résistance au roulement, "
    "résistance au mouvement, résistance à l'avancement",
    "drawbar_pull": "drawbar, pull, net traction, net pull, Zugkraft, Nettozugkraft, Zughakenkraft, "
    "Zughakenzugkraft, traction nette, force de traction, effort de traction, force au crochet, "
    "effort au crochet | DP DBP",
    "slip": "slip ratio, Schlupf, Radschlupf, glissement, taux de glissement | s i",
    "slip_angle": "Schräglaufwinkel, Schräglauf, angle de dérive, dérive",
    "slope": "slope angle, Neigung, Hangneigung, Neigungswinkel, Steigungswinkel, pente, "
    "inclinaison",
    "speed": "velocity, travel speed, forward speed, travel velocity, Geschwindigkeit, "
    "Fahrgeschwindigkeit, vitesse, vitesse d'avance, vitesse d'avancement | v",
    "pass_number": "pass, passes, pass no, number of passes, Überfahrt, Überfahrten, Überrollung, "
    "Überrollungen, passage, passages, numéro de passage, nombre de passages",
    "grouser_height": "lug height, Stollenhöhe, Greiferhöhe, hauteur de crampon, "
    "hauteur des crampons",
    "pressure": "plate pressure, normal pressure, Plattendruck, Bodendruck, Flächenpressung, Druck, "
    "pression, pression au sol | p",
    "length": "plate length, Plattenlänge, Länge, longueur",
    "normal_stress": "normal stress, sigma n, Normalspannung, contrainte normale | σ",
    "shear_stress": "Scherspannung, Schubspannung, contrainte de cisaillement | τ tau",
    "shear_displacement": "shear deformation, Scherweg, Scherverschiebung, déplacement de cisaillement, "
    "cisaillement déplacement | j",
    "torque": "wheel torque, drive torque, Drehmoment, Antriebsmoment, Raddrehmoment, couple",
    "moisture": "moisture content, water content, Feuchte, Wassergehalt, humidité, teneur en eau",
    "run": "run id, run no, run number, run name, Lauf, Versuch, Versuchsnummer, Versuch Nr, Lauf Nr, "
    "Messung, essai, numéro d'essai, test, experiment",
    "soil": "soil type, Boden, Bodenart, sol, type de sol",
    "wheel": "wheel name, wheel id, tyre, tire, Rad, Reifen, roue",
    "contact": "contact type, Kontakt, Kontaktart",
}

CONTACT_WORDS = {
    "rolling": "rollend, rollt, roulant",
    "pressed": "pressed wheel, indentation, gedrückt, eingedrückt, pressé, enfoncé",
    "plate": "round plate, circular plate, rectangular plate, flat plate, bevameter, Platte, plaque",
}
# A cell that says that nothing was measured.
_MISSING = "na n/a n.a. k.a. n.d. nd none null missing fehlt - -- – — ? . #n/a #nv"
MISSING = frozenset(_MISSING.split())


class Match(NamedTuple):
    """A quantity, and how sure: 0 our own name, 1 a word or symbol of it, 2 with words around it."""

    name: str
    rank: int


def plain(text: str) -> str:
    """Letters and digits only, in lower case, without accents; ä, ae and a are the same."""
    letters = unicodedata.normalize("NFKD", text.casefold())
    joined = "".join(c for c in letters if c.isalnum() or c in "%°")
    return re.sub("([aou])e", r"\1", joined)


def _plain_words(words: str) -> frozenset[str]:
    return frozenset(plain(word) for word in words.split())


def _index() -> tuple[dict[str, str], dict[str, str]]:
    words: dict[str, str] = {}
    symbols: dict[str, str] = {}
    for name, line in WORDS.items():
        spelled, _, short = line.partition("|")
        words |= {plain(word): name for word in (*spelled.split(","), name)}
        symbols |= dict.fromkeys(short.split(), name)
    return words, symbols


_BY_WORD, SYMBOLS = _index()
# What stands beside a quantity without making it another one.
_QUALIFIERS = _plain_words(
    "wheel tyre tire rad rads des reifens roue de la du mean average avg measured "
    "mittlere mittlerer mittleres gemessene gemessener moyen moyenne mesuré mesurée"
)
_DEVIATIONS = _plain_words(
    "standarddeviation standardabweichung écarttype stdabw stdev stddev stabw sigma std sd"
)
# Rows that a spreadsheet computes below its measurements.
_MEANS = _plain_words(
    "mean average avg mittelwert mittel durchschnitt moyenne sum total summe somme"
)
_SUMMARIES = _MEANS | _DEVIATIONS | _plain_words(
    "median médiane min minimum max maximum count anzahl nombre cv var variance varianz rms "
    "spannweite range spread étendue gesamt"
)  # fmt: skip
_STARTS = "|".join(sorted({word[:3] for word in _SUMMARIES})).replace("e", "[eéÉ]")
_SUMMARY_START = re.compile(rf"^\W*(?:{_STARTS})", re.IGNORECASE | re.MULTILINE)
_CONTACT = {
    plain(w): name for name, line in CONTACT_WORDS.items() for w in (name, *line.split(","))
}


def _tokens(text: str) -> list[str]:
    return [token for token in re.split(r"[\s_,;:/()\[\]'’=±-]+", text) if token]


def find(text: str) -> Match | None:
    """The quantity that a header without its unit names."""
    tokens = _tokens(text)
    if len(tokens) == 1 and tokens[0] in SYMBOLS:
        return Match(SYMBOLS[tokens[0]], 1)
    whole = plain(text)
    if whole in _BY_WORD:
        return Match(_BY_WORD[whole], 0 if whole == plain(_BY_WORD[whole]) else 1)
    if len(tokens) > 1:
        for symbol, rest in ((tokens[-1], tokens[:-1]), (tokens[0], tokens[1:])):
            match = find(" ".join(rest)) if symbol in SYMBOLS else None
            if match is not None and match.name == SYMBOLS[symbol]:
                return Match(match.name, 1)
    spread = next((w for w in _DEVIATIONS if whole.startswith(w) or whole.endswith(w)), None)
    if spread is not None:
        return _deviation(whole.removeprefix(spread) if whole.startswith(spread)
                          else whole.removesuffix(spread), text)  # fmt: skip
    rest = [token for token in tokens if plain(token) not in _QUALIFIERS]
    if rest and len(rest) < len(tokens):
        match = find(" ".join(rest))
        # the pressure of a tyre is not that on the soil, nor a wheel's length that of a plate
        if match is None or match.name in ("pressure", "length"):
            return None
        return Match(match.name, 2)
    return None


def _deviation(of: str, text: str) -> Match | None:
    """`sinkage_std` and the like; only of what a wheel's measurement is weighed by."""
    name = f"{_BY_WORD.get(of, SYMBOLS.get(_tokens(text)[0], ''))}_std"
    if name not in {f"{channel}_std" for channel in CHANNELS}:
        return None
    return Match(name, 0 if plain(text) == plain(name) else 1)


def near_miss(text: str) -> str | None:
    """The known word that a header is one slip of the keyboard away from."""
    whole = plain(text)
    if whole in _BY_WORD or len(whole) < 3:
        return None
    for word in difflib.get_close_matches(whole, _BY_WORD, n=3, cutoff=0.7):
        if _one_slip(whole, word):
            return _BY_WORD[word]
    return None


def _one_slip(a: str, b: str) -> bool:
    """One letter too many, too few, another one, or two neighbours the wrong way round.

    In words of four letters and fewer another letter makes another word (load, road), and a letter
    more or less does so in three (run, rung).
    """
    short = min(len(a), len(b))
    if len(a) == len(b):
        wrong = [i for i, (x, y) in enumerate(zip(a, b, strict=True)) if x != y]
        if len(wrong) == 2 and wrong[1] == wrong[0] + 1:
            i, j = wrong
            return short >= 4 and a[i] == b[j] and a[j] == b[i]
        return len(wrong) == 1 and short >= 5
    if abs(len(a) - len(b)) != 1 or short < (3 if len(a) < len(b) else 4):
        return False
    longer, shorter = (a, b) if len(a) > len(b) else (b, a)
    return any(longer[:i] + longer[i + 1 :] == shorter for i in range(len(longer)))


def contact_of(text: str) -> str:
    """`rolling`, `pressed` or `plate` for a word that means it; else the text as it is."""
    return _CONTACT.get(plain(text), text)


def may_have_summary(texts: str) -> bool:
    """Whether a line of the texts begins as the word of a summary does; quick, for many lines."""
    return _SUMMARY_START.search(texts) is not None


def is_summary(text: str, names: Collection[str] = ()) -> bool:
    """Whether a cell says that its row is a mean, a sum, a deviation of the rows around it.

    names: of the rows around it, for what is the mean of one of them (`Mean a`).
    """
    whole = plain(text)
    if whole in _SUMMARIES:
        return True
    first, *rest = [plain(token) for token in _tokens(text)] or [""]
    if first not in _MEANS | _DEVIATIONS:
        return False
    ordinary = ("of", "von", "de", "aus", "n", "value", "values", "wert")
    rest = [r for r in rest if not (r.isdigit() or r in ordinary or r in _BY_WORD)]
    return not rest or "".join(rest) in map(plain, names)
