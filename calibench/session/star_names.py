"""Proper names of bright stars by HIP number (IAU Catalog of Star Names), to label pictures with."""

STAR_NAMES: dict[int, str] = {
    677: "Alpheratz", 746: "Caph", 1067: "Algenib", 3179: "Schedar", 3419: "Diphda", 4427: "Gamma Cas", 5447: "Mirach",
    6686: "Ruchbah", 7588: "Achernar", 8886: "Segin", 9640: "Almach", 9884: "Hamal", 11767: "Polaris", 14135: "Menkar",
    14576: "Algol", 15863: "Mirfak", 17702: "Alcyone", 21421: "Aldebaran", 24436: "Rigel", 24608: "Capella",
    25336: "Bellatrix", 25428: "Elnath", 25930: "Mintaka", 25985: "Arneb", 26311: "Alnilam", 26634: "Phact",
    26727: "Alnitak", 27366: "Saiph", 27989: "Betelgeuse", 28360: "Menkalinan", 30324: "Mirzam", 30438: "Canopus",
    31681: "Alhena", 32349: "Sirius", 33579: "Adhara", 34444: "Wezen", 35904: "Aludra", 36850: "Castor", 37279: "Procyon",
    37826: "Pollux", 39953: "Regor", 41037: "Avior", 45238: "Miaplacidus", 46390: "Alphard", 49669: "Regulus",
    50583: "Algieba", 53910: "Merak", 54061: "Dubhe", 54872: "Zosma", 57632: "Denebola", 58001: "Phecda", 59774: "Megrez",
    59803: "Gienah", 60718: "Acrux", 61084: "Gacrux", 62434: "Mimosa", 62956: "Alioth", 63125: "Cor Caroli",
    63608: "Vindemiatrix", 65378: "Mizar", 65474: "Spica", 67301: "Alkaid", 68702: "Hadar", 68933: "Menkent",
    69673: "Arcturus", 71683: "Rigil Kentaurus", 72105: "Izar", 72607: "Kochab", 74785: "Zubeneschamali", 76267: "Alphecca",
    77070: "Unukalhai", 78401: "Dschubba", 78820: "Acrab", 80763: "Antares", 82273: "Atria", 82396: "Larawag",
    84012: "Sabik", 85927: "Shaula", 86032: "Rasalhague", 86228: "Sargas", 87833: "Eltanin", 90185: "Kaus Australis",
    91262: "Vega", 92855: "Nunki", 93506: "Ascella", 95947: "Albireo", 97278: "Tarazed", 97649: "Altair", 100453: "Sadr",
    100751: "Peacock", 102098: "Deneb", 102488: "Aljanah", 105199: "Alderamin", 107315: "Enif", 109268: "Alnair",
    113368: "Fomalhaut", 113881: "Scheat", 113963: "Markab",
}
