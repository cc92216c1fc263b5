# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: E501
"""Tables whose headers the reader has no words for, in twelve languages, with what each column is.

Headers are what people of the field write; the numbers are those of made rigs of several structures.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

QUANTITIES = (
    "run",
    "load",
    "diameter",
    "width",
    "slip",
    "sinkage",
    "resistance",
    "drawbar_pull",
    "torque",
)
# Headers in that order; "" where a table has no such column. Behind the bar: further columns.
WORDS: dict[str, list[str]] = {
    "Spanish": [
        "nº de serie,peso sobre la rueda,diám. exterior de la rueda,anchura de la llanta,resbalamiento,penetración,fuerza de arrastre,tiro,par",
        "corrida,carga aplicada,tamaño,espesor,patinamiento,profundidad de huella,,fuerza en la barra,",
        "id,Fv,d,a,resb,prof,Fr,Ft,M",
        "muestra,fuerza de apoyo,Ø rueda,ancho banda,,huella,fuerza de oposición,,",
        "pasada,P,diam. rueda,anch.,desliz.,hund.,res. rodadura,tracc.,par eje|humedad del suelo",
    ],
    "Italian": [
        "corsa,peso sulla ruota,diam. est.,largh.,pattinamento,sprofondamento,forza frenante,tiro,coppia motrice",
        "campione,forza verticale applicata,dimensione,spessore,scorrimento,profondità,,spinta,",
        "n,P,d,l,sl,prof,R,T,C",
        "nome,appoggio,ruota Ø,battistrada,,impronta,attrito di rotolamento,,",
        "serie,caric.,diametr.,larghez.,slitt.,affond.,resist. avanzamento,traz.,copp.|umid.",
    ],
    "Portuguese": [
        "repetição,peso na roda,diâm. externo,espessura,deslizamento relativo,penetração,força de arrasto,tração útil,binário",
        "amostra,carregamento,tamanho,faixa,patinação,profundidade do sulco,,puxada,",
        "ordem,P,d,l,desl,prof,R,Ft,T",
        "nome,apoio,Ø da roda,banda,,rastro,atrito,,",
        "nº,carg.,diâmetr.,larg.,escorr.,afund.,resist.,traç.,torq.|teor de água",
    ],
    "Polish": [
        "seria,ciężar koła,śr. zewnętrzna,grubość,buksowanie,ugięcie gruntu,siła oporu,siła ciągnąca,moment na osi",
        "pomiar,nacisk,wymiar,rozstaw,ślizg,głębokość koleiny,,ciąg,",
        "nr,P,d,s,b,h,F,T,M",
        "nazwa,docisk,koło Ø,bieżnik,,koleina,siła hamująca,,",
        "lp,obc.,średn.,szer.,pośl.,zagł.,op. toczenia,uc.,mom. obr.|wilg. gleby",
    ],
    "Japanese": [
        "番号,接地荷重,外径,タイヤ幅,滑り,めり込み量,抵抗力,引張力,軸トルク",
        "試料,重量,車輪径,厚さ,空転率,轍の深さ,,推進力,",
        "No.,鉛直力,輪径,輪幅,すべり,沈み,走行抵抗力,牽引,駆動トルク",
        "名前,輪重,外側直径,接地幅,,沈み込み,転がり抵抗力,,",
        "回,荷重W,直径D,幅B,スリップ,沈下深さ,抵抗,けん引,モーメント|水分",
    ],
    "Chinese": [
        "编号,轮重,外径,胎宽,打滑率,下沉深度,运动阻力,拉力,驱动力矩",
        "样本,重量,轮径,厚度,滑移,车辙深度,,推力,",
        "序号,垂直力,轮子直径,轮子宽度,滑转,沉降,土壤阻力,牵引,力矩",
        "名称,压力载荷,轮外径,接触宽,,陷入深度,阻碍力,,",
        "组,竖直载荷,车轮外径,车轮宽,滑差,沉深,前进阻力,挂钩力,轴扭矩|含水量",
    ],
    "Dutch": [
        "proef,belasting,wieldiameter,wielbreedte,slippercentage,insporing,rolweerstand,trekkracht,koppel",
        "meetreeks,wieldruk,afmeting,dikte,doorslip,spoordiepte,,netto trek,",
        "nr.,gewicht,diam,br,sl,d,Rw,Tr,M",
        "naam,verticale kracht,middellijn,loopvlak,,indringing,weerstandskracht,,",
        "meting,bel.,wieldiam.,br.,slp,insp.,weerst.,trekkr.,kopp.|vochtgehalte",
    ],
    "Turkish": [
        "deney no,tekerlek yükü,dış çap,tekerlek genişliği,patinaj oranı,batma miktarı,yuvarlanma direnci,çeki kuvveti,tork",
        "ölçüm,dikey kuvvet,boyut,kalınlık,kayma,iz derinliği,,net çekiş,",
        "no,yük,çap,gen.,kay.,bat.,dir.,çek.,mom.",
        "isim,ağırlık,teker çapı,taban,,çökme,direnç kuvveti,,",
        "sıra,düşey yük,çap,genişlik,patinaj,batma,yuv. dir.,çeki,döndürme momenti|nem",
    ],
    "Czech": ["pokus,zatížení,průměr kola,šířka kola,prokluz,zaboření,valivý odpor,tahová síla,krouticí moment"],
    "Hungarian": ["mérés,terhelés,átmérő,szélesség,csúszás,besüllyedés,gördülési ellenállás,vonóerő,nyomaték"],
    "Russian": ["опыт,нагрузка,диаметр,ширина,буксование,глубина колеи,сопротивление,тяга,крутящий момент"],
    "Korean": ["번호,하중,직경,폭,슬립률,침하량,주행저항,견인력,토크"],
}  # fmt: skip
# How a table says its units: in brackets, behind a comma or underscore, in a row, or not at all.
STYLES = ("square", "round", "row", "none, mm", "none, SI")
UNITS = dict(zip(QUANTITIES, ("", "N", "mm", "mm", "%", "mm", "N", "N", "Nm"), strict=True))


class Table(NamedTuple):
    """A table as CSV; truth: header by quantity."""

    name: str
    text: str
    truth: dict[str, str]


def _numbers(rng: np.random.Generator, size: int) -> dict[str, np.ndarray]:
    """A rig's numbers in N, mm, %, N m: a grid of loads and slips, some with repeats, loads as measured."""
    loads = np.sort(
        rng.choice([10, 20, 30, 45, 60, 80, 100, 150], rng.integers(2, 5), replace=False)
    )
    slips = np.sort(rng.choice([0, 5, 10, 20, 30, 40, 60], rng.integers(2, 5), replace=False))
    grid = np.array([[w, s] for w in loads for s in slips], dtype=float)
    grid = grid.repeat(rng.integers(1, 4), axis=0)
    load, slip = grid.T
    d, b = rng.choice([120.0, 200.0, 275.0, 314.7]), rng.choice([50.0, 80.0, 100.0, 165.0])
    b = min(b, 0.8 * d)
    grip = rng.uniform(0.25, 0.5) * (1.0 - np.exp(-slip / rng.uniform(8.0, 20.0)))
    share = rng.uniform(0.04, 0.15) * (load / loads.max()) ** 0.3 * (1.0 + slip / 80.0)
    z = np.minimum(
        rng.uniform(0.02, 0.1) * d * (load / loads.max()) ** 0.6 * (1.0 + slip / 50.0), 0.4 * d
    )
    noise = 1.0 + rng.choice([0.01, 0.04]) * rng.standard_normal((4, load.size))
    set_load = load * (1.0 + (0.01 * rng.standard_normal(load.size) if size % 3 == 2 else 0.0))
    found = {"load": set_load.round(2), "slip": slip, "diameter": np.full(load.size, d),
             "width": np.full(load.size, b), "sinkage": (z * noise[0]).round(2),
             "resistance": (share * load * noise[1]).round(2),
             "drawbar_pull": ((grip - share) * load * noise[2]).round(2),
             "torque": (grip * load * d / 2000.0 * noise[3]).round(3),
             "run": np.array([i for i, row in enumerate(grid) if i == 0 or (row != grid[i - 1]).any()])}  # fmt: skip
    found["run"] = np.searchsorted(found["run"], np.arange(load.size), side="right")
    return found


def tables(first: int = 0) -> list[Table]:
    """Every list of headers, each with a rig and a way to say units of its own, from a first seed on."""
    found: list[Table] = []
    for language, lists in WORDS.items():
        for i, line in enumerate(lists):
            seed = first + len(found)
            found.append(_table(f"{language} {i + 1}", line, STYLES[seed % len(STYLES)], seed))
    return found


def _table(name: str, line: str, style: str, seed: int) -> Table:
    rng = np.random.default_rng(seed)
    own, _, further = line.partition("|")
    words = dict(zip(QUANTITIES, own.split(","), strict=True))
    words = {quantity: word for quantity, word in words.items() if word}
    numbers = _numbers(rng, seed)
    kept = [q for q in QUANTITIES if q in words]
    if seed % 4 == 3:  # some have them in another order
        kept = [kept[0], *rng.permutation(kept[1:]).tolist()]
    columns: list[tuple[str, str, list[str]]] = []
    for quantity in kept:
        unit, values = UNITS[quantity], numbers[quantity]
        if style == "none, SI" and unit in ("mm", "%"):
            values = values / (1000.0 if unit == "mm" else 100.0)
        cells = [f"{v:.6g}" for v in values]
        if quantity == "run" and seed % 2:
            cells = [f"{'abcdefghijklmnopqrstuvw'[v % 23]}{v}" for v in values]
        columns.append((words[quantity], unit, cells))
    if further:
        moisture = rng.choice([4.1, 8.3], len(numbers["load"]))
        columns.append((further, "%", [f"{v:g}" for v in moisture]))
    heads = {"square": "{} [{}]", "round": "{} ({})"}.get(style, "{}")
    header = [heads.format(word, unit) if unit else word for word, unit, _ in columns]
    lines = [header]
    if style == "row":
        lines.append([unit for _, unit, _ in columns])
    lines += [list(row) for row in zip(*(cells for *_, cells in columns), strict=True)]
    text = "\n".join(";".join(row) for row in lines) + "\n"
    return Table(f"{name}, {style}", text, dict(zip(kept, header, strict=False)))
