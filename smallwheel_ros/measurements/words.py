# SPDX-License-Identifier: Apache-2.0
"""What a column is, from what stands above it: `sinkage [mm]`, `Einsinkung (mm)`, `z_mm`, `Fz, N`.

This is the one place for words: English, German, French, Spanish, Italian, Portuguese, Polish, Japanese,
Chinese, and the symbols of the field. A line more
in `WORDS` makes a word known; a quantity of its own also needs its line in `columns.COLUMNS` (unit
and range) if it has to be checked. Case, accents, hyphens, underscores and blanks do not matter in
words; in symbols (after the bar) case does.
"""

from __future__ import annotations

import difflib
import re
import unicodedata
from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import NamedTuple

from smallwheel_ros.measurements.columns import CHANNELS, COLUMNS, LAB_COLUMNS, TEXTS
from smallwheel_ros.measurements.units import DIMENSIONLESS, UnitsError, fits, is_common, spelled

WORDS: dict[str, str] = {
    "load": "normal load, vertical load, axle load per wheel, normal force, vertical force, weight, "
    "Last, Radlast, Normallast, Vertikallast, Auflast, Normalkraft, Vertikalkraft, "
    "Aufstandskraft, Gewichtskraft, Gewicht, Belastung, charge, charge verticale, charge "
    "normale, force verticale, force normale, effort normal, effort vertical, poids, carga, "
    "carga normal, carga vertical, fuerza normal, fuerza vertical, carico, carico normale, "
    "carico verticale, forza normale, forza verticale, força normal, força vertical, "
    "obciążenie, obciążenie pionowe, siła normalna, siła pionowa, 荷重, 垂直荷重, 鉛直荷重, 輪荷重, 载荷, "
    "荷载, 垂直载荷, 法向载荷, 轮载 | W Fz Fn",
    "diameter": "dia, diam, outer diameter, plate diameter, Plattendurchmesser, Durchmesser, "
    "Raddurchmesser, Reifendurchmesser, Außendurchmesser, diamètre, diamètre extérieur, "
    "diámetro, diámetro de rueda, diametro, diametro ruota, diâmetro, średnica, średnica "
    "koła, 直径, 車輪直径, 车轮直径 | D Ø",
    "radius": "Radradius, Halbmesser, rayon, radio, raggio, raio, promień, 半径 | r",
    "width": "plate width, Plattenbreite, Breite, Radbreite, Reifenbreite, largeur, ancho, ancho de "
    "rueda, anchura, larghezza, largura, szerokość, szerokość koła, 幅, 車輪幅, 宽度, 车轮宽度, 轮宽 | b "
    "B",
    "sinkage": "sinkage depth, plate sinkage, settlement, Setzung, tassement, Einsinkung, Einsinktiefe, "
    "Einsenkung, Einsenktiefe, enfoncement, profondeur d'enfoncement, hundimiento, "
    "affondamento, afundamento, zagłębienie, 沈下量, 沈下, 沉陷量, 沉陷, 下陷量 | z",
    "resistance": "motion resistance, rolling resistance, Fahrwiderstand, Rollwiderstand, "
    "Bewegungswiderstand, Widerstand, résistance, résistance au roulement, résistance au "
    "mouvement, résistance à l'avancement, resistencia, resistencia al avance, resistencia a "
    "la rodadura, resistenza, resistenza al moto, resistenza al rotolamento, resistência, "
    "resistência ao movimento, resistência ao rolamento, opór, opór ruchu, opór toczenia, "
    "走行抵抗, 転がり抵抗, 行驶阻力, 滚动阻力, 阻力",
    "drawbar_pull": "drawbar, pull, net traction, net pull, Zugkraft, Nettozugkraft, Zughakenkraft, "
    "Zughakenzugkraft, traction nette, force de traction, effort de traction, force au "
    "crochet, effort au crochet, tracción neta, fuerza de tracción, trazione netta, forza di "
    "trazione, tração líquida, força de tração, siła uciągu, uciąg, 牽引力, けん引力, 挂钩牵引力, 牵引力 | "
    "DP DBP",
    "slip": "slip ratio, Schlupf, Radschlupf, glissement, taux de glissement, deslizamiento, "
    "slittamento, escorregamento, patinagem, poślizg, スリップ率, すべり率, 滑り率, 滑转率, 滑移率 | s i",
    "slip_angle": "Schräglaufwinkel, Schräglauf, angle de dérive, dérive",
    "slope": "slope angle, Neigung, Hangneigung, Neigungswinkel, Steigungswinkel, pente, inclinaison, "
    "pendiente, pendenza, inclinação, nachylenie, 傾斜, 坡度",
    "speed": "velocity, travel speed, forward speed, travel velocity, Geschwindigkeit, "
    "Fahrgeschwindigkeit, vitesse, vitesse d'avance, vitesse d'avancement, velocidad, "
    "velocità, velocidade, prędkość, 速度, 走行速度, 行驶速度 | v",
    "pass_number": "pass, passes, pass no, number of passes, Überfahrt, Überfahrten, Überrollung, "
    "Überrollungen, passage, passages, numéro de passage, nombre de passages",
    "grouser_height": "lug height, Stollenhöhe, Greiferhöhe, hauteur de crampon, hauteur des crampons",
    "pressure": "plate pressure, normal pressure, Plattendruck, Bodendruck, Flächenpressung, Druck, "
    "pression, pression au sol | p",
    "length": "plate length, Plattenlänge, Länge, longueur",
    "normal_stress": "normal stress, sigma n, Normalspannung, contrainte normale | σ",
    "shear_stress": "Scherspannung, Schubspannung, contrainte de cisaillement | τ tau",
    "shear_displacement": "shear deformation, Scherweg, Scherverschiebung, déplacement de cisaillement, "
    "cisaillement déplacement | j",
    "torque": "wheel torque, drive torque, Drehmoment, Antriebsmoment, Raddrehmoment, couple, par "
    "motor, coppia, momento torsor, moment obrotowy, トルク, 转矩, 扭矩",
    "moisture": "moisture content, water content, Feuchte, Wassergehalt, humidité, teneur en eau, "
    "humedad, umidità, umidade, wilgotność, 含水比, 含水率",
    "run": "run id, run no, run number, run name, Lauf, Versuch, Versuchsnummer, Versuch Nr, Lauf "
    "Nr, Messung, essai, numéro d'essai, test, experiment, ensayo, prueba, prova, ensaio, "
    "próba, przejazd, 試験, 試験番号, 试验, 试验编号",
    "soil": "soil type, Boden, Bodenart, sol, type de sol, suelo, terreno, suolo, solo, gleba, grunt, "
    "土, 土壌, 土壤",
    "wheel": "wheel name, wheel id, tyre, tire, Rad, Reifen, roue, rueda, ruota, koło, 車輪, 车轮",
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


_ROUND_BRACKETS = re.compile(r"(.*\S)\s*\(([^()]*)\)")
_WIDE = str.maketrans("（）［］【】％", "()[][]%")  # as Japanese and Chinese keyboards write them
_PURE_NUMBERS = ("", "1", "-", "–", "—", "/")
_AT_THE_END = (
    r"\s*[,;:]\s*",  # load, N
    r"\s+(?:in|en|/)\s+",  # load in N
    r"\s*/\s*",  # load/N
    r"\s*(?=[%°]$)",  # slip%
    r"[\s_]+(?=[^\s_]+$)",  # load_N
    r"[\s_]+(?=[^\s_]+_[^\s_]+$)",  # speed_m_s
)
MAPPED = -1  # rank of a column that the user named, before all that was understood
UNKNOWN = 3  # rank of a column that no word is known for


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
QUALIFIERS = _plain_words(
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


def tokens_of(text: str) -> list[str]:
    """The words of a header, without what stands between them."""
    return [token for token in re.split(r"[\s_,;:/()\[\]'’=±-]+", text) if token]


def find(text: str) -> Match | None:
    """The quantity that a header without its unit names."""
    tokens = tokens_of(text)
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
        of = whole.removeprefix(spread) if whole.startswith(spread) else whole.removesuffix(spread)
        channel = _BY_WORD.get(of, SYMBOLS.get(tokens[0], ""))
        # only of what a wheel's measurement is weighed by
        rank = 0 if whole == plain(f"{channel}_std") else 1
        return Match(f"{channel}_std", rank) if channel in CHANNELS else None
    rest = [token for token in tokens if plain(token) not in QUALIFIERS]
    if rest and len(rest) < len(tokens):
        match = find(" ".join(rest))
        # the pressure of a tyre is not that on the soil, nor a wheel's length that of a plate
        if match is None or match.name in ("pressure", "length"):
            return None
        return Match(match.name, 2)
    return None


class Heading(NamedTuple):
    """A column's header, understood.

    text: as it stands in the file. name: our word for the quantity, or theirs where none is known.
    unit: as `units.to_base` takes it, None where the header has none. rank: of `Match`, `MAPPED` or
    `UNKNOWN`. factor: of the values, 2 for a radius.
    """

    text: str
    name: str
    unit: str | None
    rank: int
    factor: float = 1.0


def expected_unit(name: str) -> str | None:
    """SI unit that the quantity must have; None where any will do."""
    if name == "radius":
        return "m"
    spec = COLUMNS.get(name) or LAB_COLUMNS.get(name)
    return None if spec is None else spec.unit


def read_heading(text: str, known: Match | None = None) -> Heading:
    """Understand a header; `known` where the user has said which quantity it is.

    Raises UnitsError where a bracket is not closed or text follows it.
    """
    text = " ".join(text.split())
    return _understood(text.translate(_WIDE), known)._replace(text=text)


def _understood(text: str, known: Match | None) -> Heading:
    rest, unit = _in_square_brackets(text)
    if unit is not None:
        return _heading(text, rest, known or find(rest), unit)
    whole = None if known else find(text)
    if whole is not None and not text.endswith(")"):
        return _heading(text, text, whole, None)
    for rest, tail in splits(text):
        match = known or find(rest)
        if match is None or match.name in TEXTS:
            continue
        if SYMBOLS.get(tail) == match.name or find(tail) == (match.name, 1):
            return _heading(text, rest, match, None)
        if _fits(tail, expected_unit(match.name)):
            return _heading(text, rest, match, tail)
    if brackets := _ROUND_BRACKETS.fullmatch(text):
        rest, tail = brackets.groups()
        match = known or find(rest)
        if spelled(tail, None) is not None and (match is not None or is_common(tail)):
            return _heading(text, rest, match, tail)
    return _heading(text, text, known or whole, None)


def _in_square_brackets(text: str) -> tuple[str, str | None]:
    if "[" not in text and "]" not in text:
        return text, None
    found = re.fullmatch(r"([^\[\]]*)\[([^\[\]]*)\]", text)
    if found is None:
        raise UnitsError("expected a name and one unit in brackets at its end, like 'sinkage [mm]'")
    return found[1].strip(), found[2].strip()


def splits(text: str) -> Iterator[tuple[str, str]]:
    """Name and what may be its unit or symbol, the surest way of writing first."""
    if brackets := _ROUND_BRACKETS.fullmatch(text):
        yield brackets[1], brackets[2].strip()
    for separator in _AT_THE_END:
        parts = re.split(separator, text)
        if len(parts) > 1 and all(parts):
            where = [m.span() for m in re.finditer(separator, text)]
            for start, end in (where[0], where[-1]):
                yield text[:start], text[end:]


def _fits(tail: str, expected: str | None) -> bool:
    unit = _unit(tail, expected)
    return unit is not None and (is_common(tail) if expected is None else fits(unit, expected))


def _unit(text: str, expected: str | None) -> str | None:
    """The unit that stands behind a name, as `units.to_base` takes it; None where none is known."""
    if text in _PURE_NUMBERS:
        return DIMENSIONLESS
    return spelled(text, expected) or spelled(text.replace("_", "/"), expected)


def _heading(text: str, name: str, match: Match | None, unit: str | None) -> Heading:
    expected = None if match is None else expected_unit(match.name)
    if unit is not None:
        ours = _unit(unit, expected)
        unit = ours or unit  # one that nobody knows is said with its values
        by_symbol = match is not None and match.rank == 1 and name in SYMBOLS
        if by_symbol and ours and expected and not fits(ours, expected):
            match = None  # `s [mm]` is no slip, `i [A]` neither
    if match is None:
        return Heading(text, name, unit, UNKNOWN)
    if match.name == "radius":
        return Heading(text, "diameter", unit, max(match.rank, 1), 2.0)
    return Heading(text, match.name, unit, match.rank)


def mapped_heading(text: str, ours: str) -> Heading:
    """The heading of a column that the user named, `--map "load [kN]=F"`.

    Raises UnitsError where a bracket of either is not closed.
    """
    wanted = read_heading(ours)
    known = Match(wanted.name, MAPPED) if wanted.factor == 1.0 else Match("radius", MAPPED)
    heading = read_heading(text, known)
    unit = heading.unit if wanted.unit is None else wanted.unit
    return Heading(text, wanted.name, unit, MAPPED, wanted.factor)


def meant(heading: Heading) -> str | None:
    """The quantity that a header of none nearly names: `sinkge_mm` or `sinkage (foo)`."""
    brackets = _ROUND_BRACKETS.fullmatch(heading.name)
    match = find(brackets[1]) if brackets else None
    if match is not None:
        return match.name
    names = [heading.name, *(rest for rest, tail in splits(heading.text) if is_common(tail))]
    return next((near for name in names if (near := near_miss(name)) is not None), None)


@lru_cache(maxsize=1000)
def near_miss(text: str) -> str | None:
    """The known word that a header is one slip of the keyboard away from."""
    whole = plain(text)
    if whole in _BY_WORD or len(whole) < 3:
        return None
    close = difflib.get_close_matches(whole, _BY_WORD, n=3, cutoff=0.7)
    return next((_BY_WORD[word] for word in close if _one_slip(whole, word)), None)


def _one_slip(a: str, b: str) -> bool:
    """One letter too many, too few, another one, or two neighbours the wrong way round.

    In words of four letters and fewer another letter makes another word (load, road), and a letter
    more or less does so in three (run, rung).
    """
    shorter, longer = sorted((a, b), key=len)
    i = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), len(shorter))
    if len(a) == len(b):
        another = len(a) >= 5 and a[i + 1 :] == b[i + 1 :]
        return another or (len(a) >= 4 and a[i:] == b[i + 1 : i + 2] + b[i : i + 1] + b[i + 2 :])
    enough = len(shorter) >= (3 if shorter == a else 4)
    return enough and longer[:i] + longer[i + 1 :] == shorter


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
    first, *rest = [plain(token) for token in tokens_of(text)] or [""]
    if first not in _MEANS | _DEVIATIONS:
        return False
    ordinary = ("of", "von", "de", "aus", "n", "value", "values", "wert")
    rest = [r for r in rest if not (r.isdigit() or r in ordinary or r in _BY_WORD)]
    return not rest or "".join(rest) in map(plain, names)
